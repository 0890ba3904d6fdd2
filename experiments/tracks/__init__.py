"""The paper's experiments: one folder a track, and the stages that tracks share."""
