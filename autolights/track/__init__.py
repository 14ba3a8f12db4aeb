"""From boxes in images to lights in the world: projection, association, localisation, tracks, states, flashing."""

from autolights.track.alignment import Alignment, AlignmentConfig, RigAlignment
from autolights.track.association import Association, associate, association_cost, type_fits
from autolights.track.camera_health import CameraHealth
from autolights.track.config import TrackConfig
from autolights.track.duplicates import DuplicateConfig, Duplicates
from autolights.track.flashing import FlashVerdict, flash_verdict
from autolights.track.hmm_filter import hmm_predict, hmm_update, transition_over
from autolights.track.localization import localization_information, localize, localize_boxes
from autolights.track.manager import TrackManager
from autolights.track.memoryless import MemorylessLights
from autolights.track.observation import CameraObservation, SetObservation, explain_observation
from autolights.track.observer import MatchConfig, Observer, View
from autolights.track.place_book import PlaceBook
from autolights.track.place_config import PlaceConfig
from autolights.track.places import LightPlaces
from autolights.track.projection import ProjectedLights, join_projected, project_lights
from autolights.track.regions import RegionConfig, region_of_interest
from autolights.track.relevance import Relevance, RelevanceConfig

__all__ = [
    "Alignment",
    "AlignmentConfig",
    "Association",
    "CameraHealth",
    "CameraObservation",
    "DuplicateConfig",
    "Duplicates",
    "FlashVerdict",
    "LightPlaces",
    "MatchConfig",
    "MemorylessLights",
    "Observer",
    "PlaceBook",
    "PlaceConfig",
    "ProjectedLights",
    "RegionConfig",
    "Relevance",
    "RelevanceConfig",
    "RigAlignment",
    "SetObservation",
    "TrackConfig",
    "TrackManager",
    "View",
    "associate",
    "association_cost",
    "explain_observation",
    "flash_verdict",
    "hmm_predict",
    "hmm_update",
    "join_projected",
    "localization_information",
    "localize",
    "localize_boxes",
    "project_lights",
    "region_of_interest",
    "transition_over",
    "type_fits",
]
