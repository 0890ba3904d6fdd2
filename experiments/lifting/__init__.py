"""The lifting network, and what it is to be compared with: every module is a stage or part of one.

`hard` measures it on far turned, noisy and incomplete views, against the limit of what is possible.
"""
