"""What the estimator costs and how accurate it is, compared with a plain filter and published peers."""
