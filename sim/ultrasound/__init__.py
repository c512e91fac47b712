from ._echoes import Echoes as Echoes, ultrasound as ultrasound
from ._sonar import Sonar as Sonar
