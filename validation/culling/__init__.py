"""Whether culling keeps its promise: at fresh points, under fresh lightings, with rays that nobody else used."""
