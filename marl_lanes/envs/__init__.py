"""The environments: PettingZoo over one road, TorchRL over many."""
