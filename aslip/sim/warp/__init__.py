"""Simulations on a GPU, with MuJoCo Warp."""
