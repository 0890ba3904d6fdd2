"""Speed of each part of the method, beside the way in which the authors' code does it."""
