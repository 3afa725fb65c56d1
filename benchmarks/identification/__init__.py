"""Look-alikes: which landmark is which, in numbers and on rendered images; wrong fixes counted, with their bounds."""
