"""Where and why a model fails: comparison, screening, evidence, diagnosis, refinement."""
