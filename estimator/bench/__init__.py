"""Recognition of landmarks, compared with other methods. May import estimator.frontend and the layers below it, logs, vision,
models.
"""
