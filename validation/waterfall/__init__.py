"""Where the error comes from: a chain from the path-traced truth to the sampled pixel, one stage swapped per link."""
