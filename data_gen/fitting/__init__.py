"""Face models fitted to landmarks, edges and scans."""
