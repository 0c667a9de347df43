"""All files of this folder by name: which tool writes them, what is answered to the question, or why not read."""

from __future__ import annotations

import foreign_containers as containers
import foreign_texts as texts
from foreign_texts import ForeignFile

YES = {"accept": True}
G_COLUMNS_2 = {"mapping": {"ax_g": "column 2:g", "ay_g": "column 3", "az_g": "column 4"}}
COLUMNS_2 = {
    "mapping": {"ax_g": "column 2:m/s2", "ay_g": "column 3", "az_g": "column 4"}
    | {"gx_dps": "column 5:rad/s", "gy_dps": "column 6", "gz_dps": "column 7"}
}
"""for files without a header: which columns, and their unit"""

FILES = {
    "pandas-index.csv": ForeignFile("pandas", texts.pandas_index, YES),
    "pandas-zone.csv": ForeignFile("pandas", texts.pandas_zone, columns="agr"),
    "polars.csv": ForeignFile("polars", texts.polars_csv),
    "r.csv": ForeignFile("R", texts.r_write_csv),
    "timetable.csv": ForeignFile("MATLAB", texts.matlab_timetable, YES),
    "german.csv": ForeignFile("Excel", texts.excel_german),
    "phyphox.csv": ForeignFile("phyphox", texts.phyphox, columns="a"),
    "phyphox-european.csv": ForeignFile("phyphox", texts.phyphox_european, columns="a"),
    "TotalAcceleration.csv": ForeignFile("Sensor Logger", texts.sensor_logger, YES, columns="a"),
    "toolbox.csv": ForeignFile("Physics Toolbox", texts.physics_toolbox, YES),
    "androsensor.csv": ForeignFile("AndroSensor", texts.androsensor),
    "xsens.txt": ForeignFile("Xsens MT Manager", texts.xsens_manager, YES),
    "dot.csv": ForeignFile("Movella DOT", texts.movella_dot, YES),
    "vn.txt": ForeignFile("VectorNav", texts.vectornav_ascii, {"rate_hz": 50.0}),
    "monitor.txt": ForeignFile("Arduino IDE", texts.arduino_monitor, COLUMNS_2, coarse=(2e-4, 2e-2)),
    "mpu6050.txt": ForeignFile("i2cdevlib", texts.mpu6050_raw, refused="no column is a time"),
    "sensor_combined.csv": ForeignFile("PX4 ulog2csv", texts.ulog2csv, YES),
    "rostopic.csv": ForeignFile("ROS 1", texts.rostopic_csv, YES),
    "plotjuggler.csv": ForeignFile("PlotJuggler", texts.plotjuggler, YES),
    "omgui.csv": ForeignFile("Axivity OMGUI", texts.axivity_omgui, G_COLUMNS_2, columns="a"),
    "actigraph.csv": ForeignFile("ActiLife", texts.actigraph, YES, columns="a", coarse=(1e-3, 0)),
    "metabase.csv": ForeignFile("MbientLab MetaBase", texts.metawear, columns="a", coarse=(1e-3, 0)),
    "consensys.csv": ForeignFile("Shimmer Consensys", texts.shimmer_consensys),
    "mems.csv": ForeignFile("ST MEMS Studio", texts.st_mems_studio, coarse=(1e-3, 1e-3)),
    "labview.lvm": ForeignFile("LabVIEW", texts.labview_lvm, YES, columns="a"),
    "american.csv": ForeignFile("Excel", texts.american_loggers, refused="have the time of the row before"),
    "influx.csv": ForeignFile("InfluxDB", texts.influx_annotated, refused="one value a line; pivot"),
    "candump.log": ForeignFile("can-utils", texts.candump, refused="frames of a CAN bus"),
    "book.xlsx": ForeignFile("Excel", containers.excel_xlsx),
    "frame.parquet": ForeignFile("pandas", containers.pandas_parquet),
    "frame.feather": ForeignFile("Arrow", containers.arrow_feather),
    "arrays.npz": ForeignFile("NumPy", containers.numpy_archive, YES),
    "structure.mat": ForeignFile("MATLAB", containers.matlab_structure),
    "sensors.h5": ForeignFile("h5py", containers.hdf5_units),
    "flight.ulg": ForeignFile("PX4", containers.px4_ulog),
    "flight.bin": ForeignFile("ArduPilot", containers.ardupilot_bin),
    "flight.log": ForeignFile("Mission Planner", containers.ardupilot_text),
    "drive.bag": ForeignFile("ROS 1", containers.ros1_bag),
    "drive.mcap": ForeignFile("ROS 2", containers.ros2_mcap),
    "foxglove.mcap": ForeignFile("Foxglove", containers.foxglove_json, YES),
    "protobuf.mcap": ForeignFile("protobuf", containers.protobuf_mcap, YES),
    "drive.db3": ForeignFile("ROS 2", containers.ros2_db3),
    "labview.tdms": ForeignFile("LabVIEW", containers.labview_tdms, refused="TDMS"),
    "old.xls": ForeignFile("Excel", containers.old_excel, refused="xlsx"),
}
"""name of the file to its tool; 44 files of 34 programs"""
