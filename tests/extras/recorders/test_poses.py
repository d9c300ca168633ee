"""Tables of poses and times: names and units of a header rule; what is wrong gets one line."""

import numpy as np
import pytest

from omniocc.errors import DataError
from omniocc.extras.recorders.files import read_times
from omniocc.extras.recorders.poses import read_timed_poses

ROTATION = [[-0.48, -0.36, 0.8, 1.0], [0.64, 0.48, 0.6, 2.0], [-0.6, 0.8, 0.0, 3.0]]
"""Of the quaternion w, x, y, z = 0.5, 0.1, 0.7, 0.5 at 1, 2, 3."""
XYZW = "1,1,2,3,.1,.7,.5,.5"
EUROC = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], "
    "b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]\n"
)
BODY = ",".join(
    f"field.pose.pose.{part}" for part in (*(f"position.{k}" for k in "xyz"), *(f"orientation.{k}" for k in "xyzw"))
)
TURNED = ",".join(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
NINE = ",".join(str(value) for row in ROTATION for value in row[:3])
ROWS = ",".join(str(value) for row in ROTATION for value in row)


@pytest.fixture
def read(tmp_path):
    def write_and_read(text, kind="csv", times=None):
        (tmp_path / "poses.csv").write_bytes(text.encode())
        if times is not None:
            (tmp_path / "times.txt").write_text(times)
        return read_timed_poses(tmp_path / "poses.csv", kind, "s", None if times is None else tmp_path / "times.txt")

    return write_and_read


@pytest.mark.parametrize(
    "text",
    [
        "1,1,2,3,.5,.1,.7,.5",
        f"time,x,y,z,qx,qy,qz,qw\n{XYZW}",
        f"timestamp,tx,ty,tz,qx,qy,qz,qw\r\n{XYZW}\r\n",
        f"\ufeffTIME ; X ; Y ; Z ; Q_X ; Q_Y ; Q_Z ; Q_W\n{XYZW}".replace(",", " ; "),
        f"time,x,y,z,qx,qy,qz,qw\n{XYZW}".replace(",", "\t"),
        f"# recorded by car 7\n# timestamp [s] x [m] y [m] z [m] qx qy qz qw\n{XYZW.replace(',', ' ')}",
        "qw,qx,qy,qz,x,y,z,t\n.5,.1,.7,.5,1,2,3,1",
        "#q_w,q_x,q_y,q_z,x,y,z,time_s\n.5,.1,.7,.5,1,2,3,1",
        "time [ms],x,y,z,qw,qx,qy,qz\n1000,1,2,3,.5,.1,.7,.5",
        "timestamp_ns,x,y,z,qw,qx,qy,qz\n1000000000,1,2,3,.5,.1,.7,.5",
        f"{EUROC}1000000000,1,2,3,.5,.1,.7,.5,9,9,9,9,9,9,9,9,9",
        "#timestamp, p x, p y, p z, q w, q x, q y, q z, v x, v y, v z\n1,1,2,3,.5,.1,.7,.5,9,9,9",
        f"seq,time,{BODY},field.twist.twist.linear.x\n7,{XYZW},9",
        f"time,matrix\n1,{ROWS}",
        f"tx,ty,tz,{TURNED},time\n1,2,3,{NINE},1",
    ],
)
def test_the_header_rules_order_and_unit(read, text):
    found = read(text)
    assert found.times_s.tolist() == [1.0]
    np.testing.assert_allclose(found.poses[0], [*ROTATION, [0, 0, 0, 1]], atol=1e-15)


def test_tum_has_w_last_unless_a_comment_says_else(read):
    for text in ("1 1 2 3 .1 .7 .5 .5", "# one two three four five six seven eight\n1 1 2 3 .1 .7 .5 .5"):
        np.testing.assert_allclose(read(text, "tum").poses[0, :3], ROTATION, atol=1e-15)
    first = "# time x y z qw qx qy qz\n1 1 2 3 .5 .1 .7 .5"
    np.testing.assert_allclose(read(first, "tum").poses[0, :3], ROTATION, atol=1e-15)


def test_unit_in_the_header_of_times_of_kitti(read):
    found = read(ROWS.replace(",", " "), "kitti", "# time [ns]\n2500000000\n")
    assert found.times_s.tolist() == [2.5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,a,b,c,d,e,f,g\n1,1,2,3,1,0,0,0", "line 1: the header 'time,a,b,c,d,e,f,g' names no column x, y, z, qw"),
        ("time,x,y,z,yaw,pitch,roll\n1,1,2,3,0,0,0", "names no column qw, qx, qy, qz; give time,x,y,z,qw,qx,qy,qz or"),
        ("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1", "names no column time"),
        ("#stamp,a,b,c,d,e,f,g\n1,1,2,3,1,0,0,0", "line 1: the header 'stamp,a,b,c,d,e,f,g' names no column x"),
        ("time,x,y,z,qx,qy,qz,qw\n1,1,2,3,0,0,0,1\n2,1,2,3,0,0,0", "line 3: it has 7 cells instead of 8"),
        ("time,x,y,z,qx,qy,qz,qw\n1,1,2,3,0,0,0,0", "line 2: the pose: .*the quaternion's length is 0"),
        ("time,x,y,z,qx,qy,qz,qw\n1,1,2,nan,0,0,0,1", "line 2: 'nan' is no finite number"),
        ("time,x,y,z,qx,qy,qz,qw\n1;1,5;2;3;0;0;0;1", "line 2: '1,5' is no finite number"),
        ("time,x,y,z,qx,qy,qz,qw\n1,1,2,3,0,0,0,1\n1,1,2,3,0,0,0,1", "line 3: a pose of this time is there already"),
        ("time,x,X,y,z,qx,qy,qz,qw\n1,1,1,2,3,0,0,0,1", "names the column 'x' twice"),
        ("time,x,y,z,qx,qy,qz,qw,cov,cov\n1,1,2,3,0,0,0,1,0,0", "names the column 'cov' twice"),
        ("sec,nanosec,x,y,z,qx,qy,qz,qw\n1,1,1,2,3,0,0,0,1", "names the column 'time' twice"),
        ("time [min],x,y,z,qx,qy,qz,qw\n1,1,2,3,0,0,0,1", "the time is in min; its units are s, ms, us, ns"),
        ("time,x [mm],y [mm],z [mm],qx,qy,qz,qw\n1,1,2,3,0,0,0,1", "the column 'x [mm]' is in mm; positions are in m"),
        ("time,x,y,z,qx,qy,qz,qw\n1_0,1,2,3,0,0,0,1", "line 2: '1_0' is no finite number"),
        ("time,x,y,z,qx,qy,qz,qw\n1,1e300,2,3,0,0,0,1", "line 2: the pose: its position is 1e+300 m away"),
        (f"1,{'1' * 5000},2,3,1,0,0,0", "line 1: a cell has 5,000 characters; it must have at most 1,000"),
        ("1" * 900 + ",1,2,3,1,0,0,0", "line 1: '111111111111111111111111111111111111111 ... 111"),
        ("time,x,y,z,qx,qy,qz,qw\n", "the file holds no poses"),
        ("a" * 200_000 + ",1", "line 1: field larger than field limit"),
        ("time\0,x", "line 1 holds the byte 0x00"),
    ],
)
def test_what_is_wrong_gets_one_line(read, text, message):
    with pytest.raises(DataError, match=r"poses\.csv[:,] ") as caught:
        read(text)
    assert all(part in str(caught.value) for part in message.split(".*"))
    assert "\n" not in str(caught.value)


def test_the_file_of_a_pose_is_named_not_that_of_its_time(read):
    with pytest.raises(DataError, match=r"poses\.csv, line 1: 13 numbers of a pose; poses_format=kitti has 12"):
        read("1 1 0 0 0 0 1 0 0 0 0 1 0\n", "kitti", "0.0\n1.0\n")
    with pytest.raises(DataError, match=r"times\.txt: 2 times, but .*poses\.csv holds 1 poses"):
        read("1 0 0 0 0 1 0 0 0 0 1 0\n", "kitti", "0.0\n1.0\n")


def test_ground_truth_of_euroc_is_read_without_its_header_too(read):
    found = read("1,4.6,-1.7,.78,.5341081,-.1530291,-.8273831,-.0821521,-.027,.033,.8,-.0031,.021,.078,-.025,.136,.075")
    assert found.poses[0, :3, 3].tolist() == [4.6, -1.7, 0.78]
    assert found.poses[0, 0, 0] == pytest.approx(-0.38262196)
    matrix = read("1,1,0,0,5,0,1,0,6,0,0,1,7,0,0,0,1")
    assert matrix.poses[0, :3, 3].tolist() == [5, 6, 7]
    with pytest.raises(DataError, match=r"line 1: the last row of the matrix is"):
        read("1,1,0,0,5,0,.5,0,6,0,0,1,7,0,0,0,2")


@pytest.mark.parametrize(
    "text",
    [
        "1,a b.png",
        "time,file\n1,a b.png",
        "filename;timestamp [ms]\na b.png;1000",
        "#timestamp [ns],filename\n1000000000,a b.png",
    ],
)
def test_times_of_files_by_the_header(tmp_path, text):
    (tmp_path / "times.csv").write_text(text)
    assert read_times(tmp_path / "times.csv", "s") == {"a b.png": 1.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,a.png\n2,a.png", "line 2: the file 'a.png' has a time already; keep one"),
        ("when,what\n1,a.png", "line 1: the header 'when,what' names no column time, file; give time,file"),
        ("1,a.png\n2", "line 2: it has 1 cells instead of 2"),
        ("1,a.png\nx,b.png", "line 2: 'x' is no finite number"),
    ],
)
def test_wrong_times_get_one_line(tmp_path, text, message):
    (tmp_path / "times.csv").write_text(text)
    with pytest.raises(DataError, match=rf"times\.csv, {message}"):
        read_times(tmp_path / "times.csv", "s")
