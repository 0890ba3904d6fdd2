"""The paper's second table: expressive faces, photos and scans."""
