from ._load import load_robot as load_robot
from ._toml import panda as panda, puma560 as puma560, tx40 as tx40
from ._xml import Element as Element, parse_xml as parse_xml, read_xml as read_xml
