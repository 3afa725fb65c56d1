"""What a hostile file, argument, configuration or message does to landfix: a table of cells, each held, degraded or failed."""
