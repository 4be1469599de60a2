"""What several verbs share: one-line errors, exit codes, consoles, options, how results look; no verb."""
