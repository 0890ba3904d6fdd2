"""Predictions into metrics, and metrics into tables."""
