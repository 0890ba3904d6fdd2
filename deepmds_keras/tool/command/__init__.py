"""The command `deepmds`: its arguments, what it reads, and the files that it writes."""
