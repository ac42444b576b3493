"""What is said of plans and runs: text reports, verdicts on files, comparisons of pipelines."""
