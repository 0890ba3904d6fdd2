"""The lifting network, and what it is to be compared with: every module is a stage or part of one.

`hard` measures it on far turned, noisy and incomplete views, against the limit of what is possible.
`anatomy` replaces the parts of Deep-MDS one at a time, in the end by the distances of its shapes.
`transfer` tests methods on the faces of another model than the one they were trained on.
"""
