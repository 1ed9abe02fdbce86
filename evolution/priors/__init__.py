"""Probability distributions of genes: uniform ones, and those of the paper's preprocessor."""
