"""Files with one flipped bit, or cut off."""

import numpy as np


def damaged(content, number, seed=0):
    """Copies of the bytes: a random bit flipped, most at random places and every tenth cut there.

    A quarter of the places are among the last 1000 bytes, where directories and footers are.
    """
    generator = np.random.default_rng(seed)
    for index in range(number):
        start = max(0, len(content) - 1000) if index % 4 == 0 else 0
        place = int(generator.integers(start, len(content)))
        if index % 10 == 5:
            yield content[:place]
            continue
        changed = bytearray(content)
        changed[place] ^= 1 << int(generator.integers(8))
        yield bytes(changed)


def assert_read_as_it_was_or_refused(path, read, error, number=200):
    """Damage a file again and again: nothing else must come out of it than what is in it.

    Args:
        path: of the file; it stays as it was.
        read: gives what is in a file, comparable.
        error: that refuses a file, in one line.
        number: how often.

    Returns:
        how often it was refused.
    """
    content, wanted = path.read_bytes(), read(path)
    refused = 0
    for changed in damaged(content, number):
        path.write_bytes(changed)
        try:
            assert read(path) == wanted
        except error as caught:
            message = str(caught)
            assert "\n" not in message
            assert path.name in message
            refused += 1
    path.write_bytes(content)
    return refused
