"""The outline path and registration on real aerial images, beside plain segmentation, SIFT and decoys."""
