"""The Textual screen: pages, plots, words and colours. It computes nothing."""
