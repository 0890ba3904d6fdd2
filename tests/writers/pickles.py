"""Pickles as users have them, and as nobody should trust them."""

from __future__ import annotations

import pickle
import sys
import types

# As Python 2 wrote `{"a": numpy.array([1.5, -2.0]), "name": "r\xe9"}`: bytes as text, protocol 2.
PYTHON2 = (
    b"\x80\x02}q\x01(U\x01aq\x02cnumpy.core.multiarray\n_reconstruct\nq\x03cnumpy\nndarray\nq\x04"
    b"K\x00\x85U\x01b\x87Rq\x05(K\x01K\x02\x85cnumpy\ndtype\nq\x06U\x02f8K\x00K\x01\x87Rq\x07"
    b"(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U\x10"
    b"\x00\x00\x00\x00\x00\x00\xf8?\x00\x00\x00\x00\x00\x00\x00\xc0tbU\x04nameU\x02r\xe9u."
)


def chumpy_pickle(value, protocol):
    """Pickle of `value(Ch)`, of a class `chumpy.ch.Ch` that is not there when it is read."""

    class Ch:
        def __init__(self, **state):
            self.__dict__.update(state, _dirty_vars=set())  # as chumpy's __getstate__

    Ch.__module__, Ch.__qualname__ = "chumpy.ch", "Ch"
    module = types.ModuleType("chumpy.ch")
    module.Ch = Ch
    sys.modules |= {"chumpy": types.ModuleType("chumpy"), "chumpy.ch": module}
    try:
        return pickle.dumps(value(Ch), protocol)
    finally:
        del sys.modules["chumpy"], sys.modules["chumpy.ch"]


class Calls:
    """Calls a function when it is unpickled."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call
