"""The command `deepmds predict`: photos or landmark files in, 3D faces, pictures and pages out."""
