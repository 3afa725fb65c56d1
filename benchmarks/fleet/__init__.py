"""The fleet engine over a bucket of this machine: flight hours a core hour, bytes, memory, failures."""
