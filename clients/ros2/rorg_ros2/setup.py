from setuptools import setup

setup(
    name='rorg_ros2',
    version='0.1.0',
    packages=['rorg_ros2'],
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/rorg_ros2']),
        ('share/rorg_ros2', ['package.xml']),
    ],
    install_requires=['setuptools'],
    zip_safe=True,
    entry_points={'console_scripts': ['rorg_node = rorg_ros2.node:main']},
)
