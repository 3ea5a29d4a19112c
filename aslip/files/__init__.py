"""Files: those that ship with the package, archives of arrays, and writing without halves."""
