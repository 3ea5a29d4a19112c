"""Claims of the paper and our targets: measure, record, verdict, table."""
