from sim.ultrasound._echoes import Echoes as Echoes, ultrasound as ultrasound
from sim.ultrasound._sonar import Sonar as Sonar
