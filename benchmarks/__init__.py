"""Scripts that measure; each prints a table and says which command made it."""
