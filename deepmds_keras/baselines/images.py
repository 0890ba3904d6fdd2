"""Images of faces as networks take them."""

import numpy as np

from deepmds_keras.errors import InputError

IMAGE_SIZE = 96  # of a side of what MobileFace sees


def forward_images(network, images: np.ndarray, batch_size: int = 100) -> np.ndarray:
    """`networks.forward` for `(n, size, size, 3)` uint8 images, which it takes in [-1, 1]."""
    from deepmds_keras.networks import forward  # which imports TensorFlow

    batches = (images[i : i + batch_size] for i in range(0, len(images), batch_size))
    scaled = (batch.astype(np.float32) / 127.5 - 1 for batch in batches)
    return np.concatenate([forward(network, batch) for batch in scaled])


def image_batches(images, targets: np.ndarray, rows: np.ndarray):
    """Mini-batches of images in [-1, 1] and targets, read a few steps ahead of the training.

    Args:
        images: `(n, size, size, 3)` uint8, an array or something indexed like one.
        targets: `(n, d)` float32, what the network must predict.
        rows: `(steps, batch)` numbers of the images in each mini-batch.
    """
    import tensorflow as tf

    first = images[rows[0]], targets[rows[0]]
    signature = tuple(tf.TensorSpec(array.shape, array.dtype) for array in first)
    data = tf.data.Dataset.from_generator(
        lambda: ((images[batch], targets[batch]) for batch in rows), output_signature=signature
    )
    data = data.apply(tf.data.experimental.assert_cardinality(len(rows)))
    data = data.map(lambda image, target: (tf.cast(image, tf.float32) / 127.5 - 1, target))
    # TensorFlow's autotuning thread doubles its sleep each time, and `fit` waits for it to wake.
    options = tf.data.Options()
    options.autotune.enabled = False
    return data.prefetch(8).with_options(options)


def check_images(images: np.ndarray, image_size: int) -> np.ndarray:
    """Raise InputError for images that are not `(n >= 1, image_size, image_size, 3)` uint8."""
    images, needed = np.asarray(images), (image_size, image_size, 3)
    if images.dtype != np.uint8 or images.shape[1:] != needed or not images.size:
        raise InputError(
            f"images must be uint8 of shape (n >= 1, {image_size}, {image_size}, 3), RGB. "
            f"Received {images.dtype} of shape {images.shape}."
        )
    return images
