"""AlpaSim's traffic contract, both ways: our adversary in other simulators, and other traffic in our drives."""
