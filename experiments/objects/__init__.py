"""The methods on objects other than faces."""
