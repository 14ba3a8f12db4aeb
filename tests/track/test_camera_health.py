from autolights.track import CameraHealth


def test_all_well_there_is_nothing_to_say() -> None:
    assert CameraHealth(0.1, -0.2, 0.05, alarm=False, delay_s=0.001, delay_sigma_s=0.002).warnings() == []


def test_warnings_say_what_is_off_which_way_and_what_to_do() -> None:
    looks, exposes = CameraHealth(-1.2, 0.3, 0.05, True, 0.052, 0.002, True).warnings()
    assert looks == (
        "looks past its calibration: lights are seen 1.20 degrees too far to the left and 0.30 too low; "
        "calibrate it again"
    )
    assert exposes == "is exposed 0.052 s after its stamps, as the poses have time; check its clock"
    assert "0.040 s before" in CameraHealth(0, 0, 0, False, -0.04, 0.002, True).warnings()[0]


def test_json_is_rounded() -> None:
    told = CameraHealth(0.123456, 0.0, 0.05, alarm=False).to_json()
    assert told["yaw_deg"] == 0.1235
    assert (told["delay_s"], told["delay_alarm"], told["alarm"]) == (None, False, False)
