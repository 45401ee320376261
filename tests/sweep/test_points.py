"""Points: settings that belong together. What they are, which cells they make, and how a folder grows by them."""

import json

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep.growth import covering, grown, requests
from gpcjax.sweep.listing import commands
from gpcjax.sweep.manifest import DamagedManifest, read_manifest, write_manifest
from gpcjax.sweep.plan import count, hash_of, plan, specification_hash, varying
from gpcjax.sweep.spec import as_dict, from_dict, make_spec, read_toml, spec_of
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun, manifest_of
from tests.sweep.pretended import rows

FIRST = [
    {"policy_length_scale": 0.1, "human_length_scale": 0.2},
    {"human_length_scale": 0.4, "policy_length_scale": 0.3},
]
SECOND = [{"policy_length_scale": 0.5, "human_length_scale": 0.6}]


def spec(points=FIRST, **settings):
    return spec_of(
        **{"env": "cartpole", "algo": "gpc", "seeds": 2, "episodes": 3, "points": points} | settings
    )


def pairs(cells):
    return {tuple(dict(cell.hyperparameters)[name] for name in FIRST[0]) for cell in cells}


def test_each_point_with_each_combination_of_the_lists():
    asked = spec(error=[0, 0.1], policy_variance=[1.0, 2.0])
    cells = plan(asked)
    assert len(cells) == len(set(cells)) == count(asked) == 2 * 2 * 2 * 2
    assert pairs(cells) == {(0.1, 0.2), (0.3, 0.4)}
    assert varying(asked) == ["policy_variance", "policy_length_scale", "human_length_scale"]


def test_a_learner_has_those_that_concern_it():
    asked = spec([*FIRST, FIRST[0]], algo=["gpc", "coach"])
    assert [cell.hyperparameters for cell in plan(asked) if cell.algo == "coach"] == [(), ()]
    both = spec(
        [{"policy_length_scale": 0.1, "beta": 3.0}, {"policy_length_scale": 0.2, "beta": 3.0}],
        algo=["gpc", "coach"],
    )
    assert {cell.hyperparameters for cell in plan(both) if cell.algo == "coach"} == {(("beta", 3.0),)}
    assert count(both) == len(plan(both)) == 2 * 2 + 2


def test_their_order_and_that_of_their_names_is_no_difference():
    assert specification_hash(spec()) == specification_hash(spec(FIRST[::-1]))
    assert specification_hash(spec()) != specification_hash(spec(SECOND))
    product = spec_of(
        env="cartpole",
        algo="gpc",
        seeds=2,
        episodes=3,
        policy_length_scale=[0.1, 0.3],
        human_length_scale=[0.2, 0.4],
    )
    assert specification_hash(spec()) != specification_hash(product)


def test_a_specification_comes_back():
    assert from_dict(json.loads(json.dumps(as_dict(spec())))) == spec()
    assert "points" not in as_dict(spec_of(env="cartpole"))  # old folders keep their hashes


def test_tables_of_toml(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(
        'env = "cartpole"\nalgo = "gpc"\nseeds = 2\nepisodes = 3\n[[points]]\npolicy-length-scale = 0.1\n'
        "human_length_scale = 0.2\n[[points]]\npolicy_length_scale = 0.3\nhuman_length_scale = 0.4\n"
    )
    assert make_spec(read_toml(path)) == spec()
    path.write_text('env = "cartpole"\n[[points]]\npolicy_length = 0.1\n')
    with pytest.raises(UserError, match=r"a.toml: points: point 1: policy_length is no setting of points"):
        make_spec(read_toml(path))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([], r"points \[\]: give tables of numbers"),
        (3, "points 3: give tables of numbers"),
        ([3], r"points \[3\]: give tables of numbers"),
        ([{}], "give tables of numbers"),
        ([{3: 1.0}], "3 is no name of a setting"),
        (
            [FIRST[0], {"policy_length_scale": 1.0}],
            "point 2: it has policy_length_scale, not policy_length_scale, human",
        ),
        ([{"policy_length_scale": -1.0}], "point 1: policy_length_scale -1.0: give a number above 0"),
        ([{"policy_length_scale": float("nan")}], "policy_length_scale nan: give a number above 0"),
        ([{"policy_length_scale": [1.0, 2.0]}], "give one number for each point"),
        ([{"beta": 1.0}], "beta is no setting of points"),
        ([{"credit": 1.0}], "credit is no setting of points"),
        ([{"seeds": 1.0}], "seeds is no setting of points"),
        ([{"policy-nu": 0.5, "policy_nu": 0.5}], "it has policy-nu, policy_nu, not policy_nu"),
    ],
)
def test_no_points(points, message):
    with pytest.raises(UserError, match=message):
        spec(points)


def test_one_place_for_a_setting():
    with pytest.raises(UserError, match="policy_length_scale: it is a setting of the points, too"):
        spec(policy_length_scale=0.1)
    with pytest.raises(UserError, match="constant_rate: beside static_rate it changes nothing"):
        spec([{"static_rate": 0.1}], constant_rate=0.2)


def test_a_folder_grows_by_points():
    """What is asked for is run: not every combination of what points have."""
    manifest = manifest_of(spec())
    asked = spec(SECOND)
    assert covering(manifest, asked) is None
    manifest = grown(manifest, asked)
    assert manifest["cells"] == 6 and len(requests(manifest)) == 2
    more_seeds = spec(FIRST[:1], seeds=4)
    manifest = grown(manifest, more_seeds)
    assert manifest["cells"] == 8
    for part in (spec(), asked, more_seeds, spec(FIRST[:1], seeds=3), spec(SECOND, seeds=1)):
        assert covering(manifest, part) is not None
    crossed = spec_of(
        env="cartpole", algo="gpc", seeds=2, episodes=3, policy_length_scale=0.1, human_length_scale=0.4
    )
    listed = spec_of(
        env="cartpole", algo="gpc", seeds=2, episodes=3, policy_length_scale=0.1, human_length_scale=0.2
    )
    assert covering(manifest, crossed) is None and grown(manifest, crossed)["cells"] == 10
    assert covering(manifest, listed) is not None


def test_points_of_other_settings_than_the_folder_has(tmp_path):
    """What had its usual value until now is filled in, as with lists."""
    manifest = grown(manifest_of(spec()), spec([{"policy_variance": 0.5}]))
    assert manifest["varying"] == ["policy_length_scale", "human_length_scale", "policy_variance"]
    assert manifest["cells"] == 6
    usual = {
        "policy_length_scale": 0.2,
        "human_length_scale": 0.2,
        "policy_variance": 0.01,
    }  # Table 5.1 of the thesis
    assert covering(manifest, spec([usual | {"policy_variance": 0.5}])) is not None
    assert covering(manifest, spec([usual | {"policy_variance": 0.01}])) is None


def test_whole_numbers_stay_whole():
    """So that the rows of what was asked before belong to the folder still when it has grown."""
    of_widths = lambda *widths: spec_of(  # noqa: E731
        env="cartpole", algo="d-coach", seeds=1, points=[{"width": width, "magnitude": 1} for width in widths]
    )
    asked, more = of_widths(16, 32), of_widths(64)
    back = from_dict(json.loads(json.dumps(as_dict(asked))))
    assert back == asked and specification_hash(back) == specification_hash(asked)
    assert [type(value) for _, value in back.points[0]] == [int, float]
    manifest = grown(manifest_of(asked), more)
    assert {each["hash"] for each in requests(manifest)} == {
        specification_hash(each) for each in (asked, more)
    }


def test_the_store_knows_its_points(tmp_path):
    asked = spec()
    store = Store(begun(tmp_path / "o", asked), manifest_of(asked))
    cells = store.missing(plan(asked))
    store.append([rows(cell) for cell in cells[:3]])
    again = Store(tmp_path / "o", read_manifest(tmp_path / "o"))
    assert again.missing(plan(asked)) == cells[3:]
    assert commands(read_manifest(tmp_path / "o"), tmp_path)[0].endswith(
        "# with its 2 [[points]] in a file of settings"
    )


@pytest.mark.parametrize("points", [3, [3], [{"policy_length_scale": "x"}], "ab"])
def test_damaged_points(tmp_path, points):
    manifest = manifest_of(spec())
    manifest["specification"]["points"] = points
    manifest["hash"] = hash_of(manifest["specification"])
    (tmp_path / "o").mkdir()
    write_manifest(tmp_path / "o", manifest)
    with pytest.raises(DamagedManifest):
        read_manifest(tmp_path / "o")
