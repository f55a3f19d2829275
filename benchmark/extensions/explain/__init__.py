"""Why a protocol and the exact truth disagree: the clearest case of each cause, as a picture."""
