"""Vehicle, date and software version come from metadata, else from the path, else unknown."""

import pytest

from workers.errors import LogUnusableError
from workers.ingest.identity import Identity, identify, match_path

TEMPLATE = "{vehicle}/{date}/{name}"


def test_the_path_is_matched_from_the_right() -> None:
    found = identify("fleet/west/car-7/2024-05-01/drive", [], path_template=TEMPLATE)
    assert found == Identity(vehicle="car-7", date="2024-05-01", software_version="unknown")


def test_metadata_wins_over_the_path_field_by_field() -> None:
    records = [{"vehicle": "car-8", "software_version": "2.1", "date": " "}]
    found = identify("car-7/2024-05-01/drive", records, path_template=TEMPLATE)
    assert found == Identity(vehicle="car-8", date="2024-05-01", software_version="2.1")


def test_without_either_all_is_unknown() -> None:
    assert identify("drive", [], path_template=TEMPLATE) == Identity()


def test_parts_without_metadata_take_that_of_the_others() -> None:
    records = [{}, {"vehicle": "car-8"}, {"vehicle": "car-8", "date": "today"}]
    assert identify("x", records, path_template=TEMPLATE).vehicle == "car-8"


def test_parts_that_name_different_vehicles_are_refused() -> None:
    with pytest.raises(LogUnusableError, match=r"different vehicles: car-7, car-8 \(a/b\)"):
        identify("a/b", [{"vehicle": "car-8"}, {"vehicle": "car-7"}], path_template=TEMPLATE)


@pytest.mark.parametrize(
    ("template", "log_id", "expected"),
    [
        pytest.param(
            "{date}_{vehicle}_v{software_version}/{name}",
            "logs/2024_car-1_v3.2/a",
            {"date": "2024", "vehicle": "car-1", "software_version": "3.2", "name": "a"},
            id="several in one segment",
        ),
        pytest.param("{vehicle}/raw.d/{name}", "car/rawXd/a", {}, id="a dot is a dot"),
        pytest.param("{vehicle}/{date}/{name}", "car/a", {}, id="too few segments"),
        pytest.param("drive", "x/drive", {}, id="no placeholder"),
    ],
)
def test_a_template_is_text_with_placeholders(
    template: str, log_id: str, expected: dict[str, str]
) -> None:
    assert match_path(log_id, template) == expected


def test_a_template_that_names_a_placeholder_twice_is_refused() -> None:
    with pytest.raises(LogUnusableError, match="twice"):
        match_path("a/b", "{name}/{name}")
