"""The numbers of a map audit: what counts as seen, and from when a map is said to be wrong."""

from pydantic import Field

from autolights.core.config import Config


class MapAuditConfig(Config):
    """Limits.

    Attributes:
        min_score: Detections below it say nothing.
        min_height_px: A light of fewer pixels may be missed whatever the map says.
        facing_deg: So may one whose face looks farther past the vehicle.
        same_place_heights: A detection this close to a light of the map, in heights of its box, is that light, of
            whatever type it is.
        min_images: So many images are needed for any finding.
        min_way_m: From places at least so far apart; two drives do as well.
        missing_share: An unmapped light must have been detected in this share of the images that should show it.
        missing_sigma_m: Its place must be known this well.
        extra_share: A light of the map that was detected in no more than this share of them is not there.
        moved_m: A light has moved if it hangs at least so far from its place in the map, less one standard deviation,
        moved_chance: counted along those axes along which errors put it there with no more than this probability.
        moved_max_m: But no farther than this. A missing light and one of the map are one that moved, if they are of one
            type, no farther apart,
        moved_share: and if the latter was detected in no more than this share of the images that should show it.
        type_share: A light is of another type if so many of its detections say so.
        same_light_m: Unmapped lights of several drives, or of one drive but never in one image, are one light if they
            are no farther apart than this.
        free_map_m: How far off the map may be: standard deviation per axis, where the images have not spoken yet.
    """

    min_score: float = Field(default=0.25, ge=0, lt=1)
    min_height_px: float = Field(default=14.0, gt=0)
    facing_deg: float = Field(default=60.0, gt=0, le=90)
    same_place_heights: float = Field(default=0.75, gt=0)
    min_images: int = Field(default=20, ge=1)
    min_way_m: float = Field(default=8.0, ge=0)
    missing_share: float = Field(default=0.7, gt=0, le=1)
    missing_sigma_m: float = Field(default=1.0, gt=0)
    extra_share: float = Field(default=0.1, ge=0, lt=1)
    moved_m: float = Field(default=0.5, gt=0)
    moved_chance: float = Field(default=1e-3, gt=0, lt=1)
    moved_max_m: float = Field(default=3.0, gt=0)
    moved_share: float = Field(default=0.5, ge=0, lt=1)
    type_share: float = Field(default=0.8, gt=0.5, le=1)
    same_light_m: float = Field(default=1.0, gt=0)
    free_map_m: float = Field(default=2.0, gt=0)
