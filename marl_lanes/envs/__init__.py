"""The environments: PettingZoo with one road, TorchRL with many."""
