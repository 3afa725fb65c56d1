"""One file a source: what makes its messages usable, what measurement they are, and how far the source is trusted."""
