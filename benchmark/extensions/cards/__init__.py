"""Cards: what a hub, a search engine and a reader are told of a data set or of results (docs/extensions/cards.md)."""
