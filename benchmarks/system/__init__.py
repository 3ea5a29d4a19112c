"""Speed, memory and faults of the parts."""
