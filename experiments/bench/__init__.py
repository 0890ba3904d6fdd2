"""How fast each part of the method is, beside the way in which the authors' code does it."""
