"""The mathematics: arrays in, arrays out; knows neither ROS nor files."""
