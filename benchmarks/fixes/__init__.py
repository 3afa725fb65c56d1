"""Single fixes on rendered and recorded pairs: accuracy, consistency, range of convergence."""
