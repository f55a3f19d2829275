"""Statistics of records: rates with intervals, comparisons, transfer, diagnosis, disagreement of protocols."""
