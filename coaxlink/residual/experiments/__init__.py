"""The run or flight that would tell rival explanations apart."""
