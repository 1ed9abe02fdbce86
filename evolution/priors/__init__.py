"""Prior distributions of genes: uniform, or from the paper's preprocessor."""
