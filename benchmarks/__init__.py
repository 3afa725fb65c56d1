"""What the estimator costs and how accurate it is, measured beside a plain filter and beside published peers."""
