from ._column_mapping import ColumnMapping as ColumnMapping
from ._named_columns import load_columns as load_columns
from ._recording_files import (
    RecordingChunk as RecordingChunk,
    iterate_recording as iterate_recording,
    load_recording as load_recording,
    load_recordings as load_recordings,
    save_recording as save_recording,
)
