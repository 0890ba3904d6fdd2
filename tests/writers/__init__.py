"""Writers of small files in the layouts that users have, shared by tests of several folders."""
