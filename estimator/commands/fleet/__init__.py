"""`landfix fleet`: run, compare, show. May import estimator.commands.common, estimator.tools.fleet and what is below it."""
