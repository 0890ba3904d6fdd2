"""A checkpoint with the names and shapes of the released RingNet's tensors."""

from __future__ import annotations

import numpy as np
import tensorflow as tf

v1 = tf.compat.v1


def write_checkpoint(
    prefix, *, image="input_images_1", camera=3, scope="Flamenetnormal_2", python=False
):
    """A graph of TensorFlow 1 whose outputs are linear in the mean colours, and its weights."""
    rng = np.random.default_rng(0)
    with tf.Graph().as_default():
        placeholder = v1.placeholder(tf.float32, (1, 224, 224, 3), name=image)
        colours = tf.reduce_mean(placeholder, (1, 2))
        if python:
            colours = tf.reshape(v1.py_func(np.sin, [colours], tf.float32), (1, 3))
        arrays = {
            name: rng.normal(0, 0.1, (camera, n)).astype("f4")
            for name, n in (("to_parameters", 159), ("to_vertices", 3 * 5023))
        }
        to_parameters, to_vertices = (
            v1.get_variable(name, initializer=array, use_resource=False)
            for name, array in arrays.items()
        )
        for name in ("add", "add_1", "add_2"):
            parameters = v1.add(tf.matmul(colours, to_parameters), 0.0, name=name)
        with v1.name_scope(scope):
            flat = tf.reshape(tf.matmul(colours, to_vertices), (1, 5023, 3))
            v1.add(flat, tf.reshape(parameters[:, :3], (1, 1, 3)), name="Add_9")
        saver = v1.train.Saver()
        with v1.Session() as session:
            session.run(v1.global_variables_initializer())
            saver.save(session, str(prefix))
    return arrays
