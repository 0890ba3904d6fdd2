"""The paper's third table: photos, to which a face model is fitted."""
