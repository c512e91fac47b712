from ._ultrasound import Echoes as Echoes, ultrasound as ultrasound
from ._ultrasound_echo import Sonar as Sonar
