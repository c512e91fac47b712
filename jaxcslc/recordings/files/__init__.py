"""Readers and writers of recording files: CSV, Parquet, NumPy, and bags of ROS.

     file --> _tables --> _csv_table, _binary_tables, _bag --> columns
                                                                  |
     _layouts, _column_mapping (which columns are what) --> Layout --> Recording

- `_recording_files`: `load_recording`, `save_recording` and reading in chunks.
- `_tables`: the type of a file, its columns in SI units, and checks.
- `_csv_table`, `_binary_tables`, `_bag`: one family of file types each.
- `_layout`: which columns are a recording's, and units.
- `_layouts`: formats that are recognised by their column names.
- `_column_mapping`: a user's own mapping of columns.
"""

from ._column_mapping import ColumnMapping as ColumnMapping
from ._recording_files import (
    RecordingChunk as RecordingChunk,
    iterate_recording as iterate_recording,
    load_recording as load_recording,
    load_recordings as load_recordings,
    save_recording as save_recording,
)
from ._tables import load_columns as load_columns
