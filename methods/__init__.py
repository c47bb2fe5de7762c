"""Our own methods: the proposed one and its ablations."""
