"""Protection levels against true errors over many flights, with and without faults: `python -m benchmarks.integrity`."""
