"""What all sources share: rules, the measurement, the machine of trust, gates, faults. May import models."""
