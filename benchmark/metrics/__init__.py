"""What records say in numbers: rates with intervals, comparisons, transfer, diagnosis, disagreement of protocols."""
