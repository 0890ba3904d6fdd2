"""Arrays into pictures: every function returns a matplotlib Figure, `style.save` writes it."""
