"""Visual odometry alone, without a filter: drift, covariance, lost steps, false motion and time."""
