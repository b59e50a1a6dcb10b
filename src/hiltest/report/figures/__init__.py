"""The plots of a run's page, one module a subject, each drawn from the run's tables as SVG."""
