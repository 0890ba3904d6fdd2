"""Cameras: shapes of faces into 2D views of their landmarks."""
