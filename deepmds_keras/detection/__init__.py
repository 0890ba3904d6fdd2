"""Detectors of 2D landmarks in photos: dlib's and MediaPipe's."""
