"""Recognition of landmarks, compared with other methods: `landfix bench recognition`."""
