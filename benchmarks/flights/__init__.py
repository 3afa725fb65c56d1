"""Whole flights, recorded and rendered: accuracy and consistency, beside a plain filter and published peers."""
