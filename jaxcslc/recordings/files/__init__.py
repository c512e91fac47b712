"""Readers and writers of recording files: CSV, Parquet, NumPy, and bags of ROS.

     file --> _tables, _bag -----------------------------> columns
                                                              |
     _known_layouts, _column_mapping (which columns are what) --> ColumnLayout --> Recording

- `_recording_files`: `load_recording`, `save_recording`, reading in chunks, and commanded
  positions of servos.
- `_tables`, `_bag`: the type of a file, its columns in SI units, and checks.
- `_layout`: which columns are a recording's, and units.
- `_known_layouts`: formats that are recognised by their column names.
- `_column_mapping`: a user's own mapping of columns.
- `_column_guess`: guesses of one for unknown formats, by names and by values.
"""

from ._column_guess import (
    guessed_mapping as guessed_mapping,
    mapping_by_values as mapping_by_values,
)
from ._column_mapping import ColumnMapping as ColumnMapping
from ._recording_files import (
    CommandTable as CommandTable,
    RecordingChunk as RecordingChunk,
    column_names_of as column_names_of,
    commands_of as commands_of,
    iterate_recording as iterate_recording,
    load_columns as load_columns,
    load_commands as load_commands,
    load_recording as load_recording,
    load_recordings as load_recordings,
    save_recording as save_recording,
)
