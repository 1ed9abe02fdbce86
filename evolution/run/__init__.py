"""Runs of an optimizer: the loop, its journal on disk, and the history read from it."""
