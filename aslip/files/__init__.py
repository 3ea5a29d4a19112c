"""Shipped files, archives of arrays, and atomic writing."""
