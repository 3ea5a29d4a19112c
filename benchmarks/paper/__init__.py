"""Comparisons with the numbers and figures of the paper."""
