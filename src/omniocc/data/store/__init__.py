"""Scene folders on disk or in an object store: frames, shards, indices and per-frame caches."""
