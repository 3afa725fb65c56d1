"""CSV text as people write it: headers, units, stamps, damage."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from logs.importers.csv_table import ACCEL, ATTITUDE, GYRO, Table, read_table
from logs.importers.recording import EPOCH_NS
from logs.store.reader import LogError

IMU = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n"


def table(folder: Path, text: str, t0_ns: int | None = None) -> Table:
    path = folder / "imu.csv"
    path.write_text(text)
    return read_table(path, t0_ns)


def test_columns_are_found_by_name_in_any_order_and_any_of_the_usual_spellings(tmp_path: Path) -> None:
    t = table(tmp_path, "az,ay,ax,gyro_z,gyro_y,gyro_x,timestamp_s\n9.8,2,1,0.3,0.2,0.1,0.5\n")
    np.testing.assert_array_equal(t.needed(GYRO, "xyz"), [[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(t.needed(ACCEL, "xyz"), [[1.0, 2.0, 9.8]])
    assert t.t_ns.tolist() == [EPOCH_NS + 500_000_000]


def test_a_unit_in_the_header_is_converted(tmp_path: Path) -> None:
    t = table(tmp_path, "t_ms,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s,ax_g,ay_g,az_g\n1500,180,-90,0,0,0,-1\n")
    np.testing.assert_allclose(t.needed(GYRO, "xyz"), [[np.pi, -np.pi / 2, 0.0]], rtol=1e-15)
    np.testing.assert_allclose(t.needed(ACCEL, "xyz"), [[0.0, 0.0, -9.80665]], rtol=1e-15)
    assert t.t_ns.tolist() == [EPOCH_NS + 1_500_000_000]


def test_headers_of_the_asl_layout(tmp_path: Path) -> None:
    header = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],"
    t = table(tmp_path, header + "a_RS_S_z [m s^-2]\n1403637130538319105,0.1,0.2,0.3,9,1,2\n")
    assert t.t_ns.tolist() == [1403637130538319105]  # to the last digit: a double would end in ...104
    np.testing.assert_array_equal(t.needed(ACCEL, "xyz"), [[9.0, 1.0, 2.0]])


@pytest.mark.parametrize(
    ("header", "cell", "t_ns"),
    [
        ("t_s", "12.000000001", EPOCH_NS + 12_000_000_001),
        ("t_s", "1.001", EPOCH_NS + 1_001_000_000),  # times 1e9 it is a little less
        ("t_s", "-0.415", EPOCH_NS - 415_000_000),
        ("t_s", "1403637130.538319105", 1403637130538319105),
        ("t_s", "1403637130.49", 1403637130490000000),
        ("time_us", "1403637130538319", 1403637130538319000),
        ("timestamp", "1403637130538319105", 1403637130538319105),
        ("timestamp", "1403637130538", 1403637130538000000),
        ("timestamp", "3.25", EPOCH_NS + 3_250_000_000),
    ],
)
def test_stamps_are_exact_to_the_nanosecond(tmp_path: Path, header: str, cell: str, t_ns: int) -> None:
    assert table(tmp_path, f"{header},x\n{cell},0\n").t_ns.tolist() == [t_ns]


def test_stamps_since_the_start_are_counted_from_t0(tmp_path: Path) -> None:
    assert table(tmp_path, "t_s,x\n0.000000001,0\n", 1403637130498319104).t_ns.tolist() == [1403637130498319105]


def test_a_cell_that_is_no_number_is_nan_and_its_row_stays(tmp_path: Path) -> None:
    t = table(tmp_path, IMU + "0,1,2,3,4,5,6\n1,,n/a,nan,4,5,6\n")
    assert len(t.t_ns) == 2
    assert np.isnan(t.needed(GYRO, "xyz")[1]).all()
    np.testing.assert_array_equal(t.needed(ACCEL, "xyz")[1], [4.0, 5.0, 6.0])


def test_duplicate_and_backward_stamps_stay_where_they_are(tmp_path: Path) -> None:
    t = table(tmp_path, "t_s,x\n0,0\n2,1\n2,1\n1,2\n")
    assert ((t.t_ns - EPOCH_NS) // 10**9).tolist() == [0, 2, 2, 1]
    assert t.values[:, 1].tolist() == [0.0, 1.0, 1.0, 2.0]


def test_lines_without_the_right_number_of_cells_are_left_out_and_reported(tmp_path: Path) -> None:
    t = table(tmp_path, IMU + "0,1,2,3,4,5,6\n1,1,2,3\n2,1,2,3,4,5,6\n3,1,2,3,4,5")
    assert ((t.t_ns - EPOCH_NS) // 10**9).tolist() == [0, 2]
    assert t.notes == ("imu.csv: 2 lines without 7 cells left out",)


def test_lines_without_a_stamp_are_left_out_and_reported(tmp_path: Path) -> None:
    t = table(tmp_path, "t_s,arrived_s,x\n0,1,5\nnan,2,6\n,3,7\n4,5,8\n")
    assert t.values[:, 2].tolist() == [5.0, 8.0]
    assert t.arrived_ns is not None
    assert ((t.arrived_ns - EPOCH_NS) // 10**9).tolist() == [1, 5]
    assert t.notes == ("imu.csv: 2 lines without a time left out",)


def test_a_torn_gzip_file_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    rows = "".join(f"{k},{x:.9f}\n" for k, x in enumerate(rng.standard_normal(5000)))
    path = tmp_path / "imu.csv.gz"
    path.write_bytes(gzip.compress(("t_s,x\n" + rows).encode())[:-9000])
    t = read_table(path)
    assert 1000 < len(t.t_ns) < 5000
    assert t.notes[0] == "imu.csv.gz: torn; read as far as it goes"
    np.testing.assert_array_equal(t.values[:-1, 0], np.arange(len(t.t_ns) - 1))


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "the file is empty"),
        (IMU.encode(), "no line after the header"),
        (b"0,1,2\n1,2,3\n", "the first line must name the columns"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe\x00", "not a CSV text file"),
        (b"gx,gy\n1,2\n", "no column of time (t_s or timestamp_ns); it has gx, gy"),
        (b"t_s,x\nyesterday,2\n", "no number in column t_s"),
        (b"t_s,x\nnan,2\n", "no number in column t_s"),
        (b"t_s,x\n1\n", "no line with 2 cells, as the header has"),
    ],
)
def test_what_is_no_table_is_reported_in_one_line(tmp_path: Path, content: bytes, line: str) -> None:
    path = tmp_path / "imu.csv"
    path.write_bytes(content)
    with pytest.raises(LogError) as raised:
        read_table(path)
    assert str(raised.value).startswith("imu.csv: ")
    assert line in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_file_that_only_claims_to_be_gzip(tmp_path: Path) -> None:
    path = tmp_path / "imu.csv.gz"
    path.write_text(IMU)
    with pytest.raises(LogError, match="not a gzip file"):
        read_table(path)


def test_a_missing_column_is_reported_with_those_that_are_there(tmp_path: Path) -> None:
    t = table(tmp_path, "t_s,gx,gy\n0,1,2\n")
    with pytest.raises(LogError, match=r"imu\.csv: no column for angular rate z .*gz_rad_s.*; it has t_s, gx, gy"):
        t.needed(GYRO, "xyz")
    with pytest.raises(LogError, match="no column for specific force x"):
        t.needed(ACCEL, "xyz")
    assert t.vector(ATTITUDE, "wxyz") is None


@pytest.mark.parametrize(
    ("stamps", "values"), [(["1.76723e+09"] * 400, "400 stamps have one value"), (["1", "2"] * 100, "200 stamps have 2 values")]
)
def test_stamps_whose_digits_were_cut_off_are_refused(tmp_path: Path, stamps: list[str], values: str) -> None:
    with pytest.raises(LogError, match=f"imu.csv: {values}"):
        table(tmp_path, IMU + "".join(f"{t},0,0,0,0,0,-9.8\n" for t in stamps))


def test_batches_of_an_imu_that_are_stamped_on_arrival_are_read(tmp_path: Path) -> None:
    assert len(table(tmp_path, "t_s,x\n" + "".join(f"{k // 20},0\n" for k in range(400))).t_ns) == 400


def test_names_of_rostopic_echo(tmp_path: Path) -> None:
    header = "%time,field.header.seq,field.header.stamp,field.header.frame_id"
    header += "".join(f",field.{name}.{axis}" for name in ("angular_velocity", "linear_acceleration") for axis in "xyz")
    t = table(tmp_path, header + "\n1403637130538319200,7,1403637130538319105,imu_link,0.1,0.2,0.3,1,2,9.8\n")
    np.testing.assert_array_equal(t.needed(GYRO, "xyz"), [[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(t.needed(ACCEL, "xyz"), [[1.0, 2.0, 9.8]])
    assert t.t_ns.tolist() == [1403637130538319105]


@pytest.mark.parametrize("line", ["0.1,0,0,0,0,0,-9.8", "0.1,nan,nan,nan,nan,nan,nan", "1403637130538319105,7,imu_link,0.1,0.2"])
def test_a_file_without_a_header_is_refused_in_words(tmp_path: Path, line: str) -> None:
    with pytest.raises(LogError, match=r"imu\.csv: no header"):
        table(tmp_path, f"{line}\n{line}\n")


def test_quotes_and_a_remark_above_the_header_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "imu.csv"
    path.write_text('# flown by hand\n"t_s","gx_rad_s"\n"0.00","1.5"\n"0.01","2.5"\n')
    table = read_table(path)
    assert table.names == ("t_s", "gx_rad_s")
    assert table.values[:, 1].tolist() == [1.5, 2.5]
