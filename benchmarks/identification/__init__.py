"""Look-alikes: which landmark is which, in numbers and on rendered images."""
