"""Cards of data sets and of weights in the form of the Hugging Face hub: README.md."""

from rlbench.benchmark.hub_cards.dataset import dataset_card
from rlbench.benchmark.hub_cards.weights import weights_card

__all__ = ["dataset_card", "weights_card"]
