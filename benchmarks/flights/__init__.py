"""Whole flights, recorded and rendered: accuracy and consistency, with a plain filter and published peers."""
