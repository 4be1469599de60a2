"""From what was found to what is reported: names with their numbers, errors before and after, doubts."""
