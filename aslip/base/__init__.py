"""What all rooms use: imports, files, processes, programs, compiled loops, intervals, tables."""
