"""What a hostile file, argument or configuration does to landfix: a table of cells, each held, degraded or failed."""
