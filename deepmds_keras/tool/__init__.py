"""The tool: photos, videos and landmark files to 3D faces; it uses the package, not vice versa."""
