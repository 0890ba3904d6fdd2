"""A page of one file that finds faces by a camera and shows them in 3D, in the browser alone."""
