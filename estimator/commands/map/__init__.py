"""`landfix map`: build, learn, check, show. May import estimator.commands.common, estimator.tools.maps and what is below it."""
