"""Philox4x32-10 and the road's stream of random numbers, in plain integers."""


def philox(counter, key):
    """Philox4x32-10: four 32-bit words under two key words."""
    words, keys = list(counter), list(key)
    for _ in range(10):
        high_0, low_0 = divmod(0xD2511F53 * words[0], 2**32)
        high_1, low_1 = divmod(0xCD9E8D57 * words[2], 2**32)
        words = [high_1 ^ words[1] ^ keys[0], low_1, high_0 ^ words[3] ^ keys[1], low_0]
        keys = [(keys[0] + 0x9E3779B9) % 2**32, (keys[1] + 0xBB67AE85) % 2**32]
    return words


class Random:
    """Stream ``stream`` of ``key``, ``count`` numbers drawn."""

    def __init__(self, key, stream, count):
        self.key, self.stream, self.count = key, stream, count

    def uniform(self, low, high):
        counter = self.count % 2**32, self.count // 2**32, self.stream % 2**32, self.stream // 2**32
        words = philox(counter, (self.key % 2**32, self.key // 2**32))
        self.count += 1
        return low + (high - low) * ((words[1] * 2**32 + words[0]) // 2**11) / 2**53

    def choose(self, shares):
        """A key of ``shares``, drawn with its share of the sum."""
        draw, total, below = self.uniform(0.0, 1.0), sum(shares.values()), 0.0
        for name, share in shares.items():
            below += share / total
            if draw < below:
                return name
        return [name for name, share in shares.items() if share][-1]
