"""Benchmarks that a user runs himself: what the vehicle's eyes recognise, beside what others would."""
