from .page import LivePage as LivePage
