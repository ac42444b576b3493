"""Reports on plans and runs: text reports, verdicts on files, comparisons of pipelines."""
