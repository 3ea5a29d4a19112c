"""Foundation of all packages: imports, files, processes, programs, compiled loops, intervals."""
