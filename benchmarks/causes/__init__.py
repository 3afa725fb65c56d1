"""Faults drawn blind into recorded flights: does the first sentence name the stream and the cause, and is a sound log accused?"""
