"""Evolution of body and gait together: the paper's genetic algorithm and its preprocessor."""
