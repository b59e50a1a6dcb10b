"""The plots of a run's page, one module per subject, each drawn from the run's tables as SVG."""
