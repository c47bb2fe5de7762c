"""The core: contract, budget, clips, tracing, running, latency, training tools and command line."""
