"""Is the map right? Drives that passed its lights say which are missing, gone, moved or of another type."""

from autolights.map_audit.audit import MapAudit, audit_map, table
from autolights.map_audit.config import MapAuditConfig
from autolights.map_audit.correction import write_corrected_map
from autolights.map_audit.evidence import DriveEvidence, Evidence, Sighting, gather_evidence
from autolights.map_audit.findings import KINDS, Finding, Findings, find

__all__ = [
    "KINDS",
    "DriveEvidence",
    "Evidence",
    "Finding",
    "Findings",
    "MapAudit",
    "MapAuditConfig",
    "Sighting",
    "audit_map",
    "find",
    "gather_evidence",
    "table",
    "write_corrected_map",
]
