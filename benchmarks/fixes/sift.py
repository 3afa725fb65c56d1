"""What vision is compared with: SIFT and FLANN between the images of a pair, ratio 0.75, RANSAC 3 px, at least 10 inliers."""

import time
from dataclasses import dataclass

import cv2
import numpy as np

from vision.describe.survey import grey
from vision.image.rectify import Image

KEYPOINTS = 1000  # strongest ones of each image
RATIO, RANSAC_PX, LEAST_INLIERS = 0.75, 3.0, 10


@dataclass(frozen=True)
class Matched:
    """Processor time, key points of the poorer image, and inliers of the homography."""

    seconds: float
    points: int
    inliers: int


def sift_and_flann(left: Image, right: Image) -> Matched | None:
    """Key points, matches by the nearest two neighbours, homography; None where fewer than ten agree."""
    begin = time.process_time()
    sift = cv2.SIFT.create(KEYPOINTS)
    (a, da), (b, db) = (sift.detectAndCompute(grey(x), np.array([])) for x in (left, right))
    if min(len(a), len(b)) < 2:
        return None
    pairs = cv2.FlannBasedMatcher({"algorithm": 1, "trees": 5}, {"checks": 50}).knnMatch(da, db, k=2)
    good = [m for m, n in pairs if m.distance < RATIO * n.distance]
    if len(good) < LEAST_INLIERS:
        return None
    source = np.array([a[m.queryIdx].pt for m in good], dtype=np.float32)
    target = np.array([b[m.trainIdx].pt for m in good], dtype=np.float32)
    _, inliers = cv2.findHomography(source, target, cv2.RANSAC, RANSAC_PX)
    seconds, agreed = time.process_time() - begin, int(np.sum(inliers))
    return Matched(seconds, min(len(a), len(b)), agreed) if agreed >= LEAST_INLIERS else None
