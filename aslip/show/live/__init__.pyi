from .page import LivePage as LivePage
from .robot_page import RobotPage as RobotPage
