"""What is found out by many solves: critical loads, all equilibria, terms that matter, tradeoffs, sweeps."""
