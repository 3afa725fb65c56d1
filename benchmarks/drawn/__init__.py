"""Faults drawn at random: kinds, sizes, onsets, durations, combinations, manoeuvres; rare ones by importance sampling."""
