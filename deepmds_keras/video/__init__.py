"""Video: its frames, the faces in them from frame to frame, and a video of what was found."""
